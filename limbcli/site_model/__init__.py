"""The model of a site: levels, layers, mesh inputs and checks, indentation model, mesh study."""
