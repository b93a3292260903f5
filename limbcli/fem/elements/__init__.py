"""Tissue elements: shape functions, cell groups, compiled element loops, sparsity pattern of the matrix."""
