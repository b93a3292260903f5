"""What `run` leaves: the force-depth curve and its facts, the time series for ParaView."""
