"""Outputs of `run`: the force-depth curve and its data, the time series for ParaView."""
