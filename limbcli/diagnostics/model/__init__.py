"""What a diagnosis is given: the data with their noise, a model that can be fitted, its linearised fit."""
