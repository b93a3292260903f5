"""The tissue's elements: shape functions, groups of cells, compiled loops over them, the matrix's pattern."""
