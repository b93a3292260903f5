"""A site as it is simulated: levels, layers, mesh inputs and checks, indentation model, mesh study."""
