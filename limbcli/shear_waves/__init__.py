"""Shear waves in deformed tissue: speed, pixels of the scanner, prediction from a simulation.

speed : the speed in a deformed state, of any law; it alone chooses the formula
ogden : the formula for the Ogden family, closed in the principal stretches
any_law : the formula for every other law, from the law's own tangent
pixels : from speeds at elements to the pixels of the scanner's window
from_simulation : the maps that the scanner would show at the times of a simulation

A law has one formula. `tests/shear_waves/test_speed.py` proves that both formulas and the
second difference of the energy agree for every law and state.
"""
