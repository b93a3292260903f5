"""Shear waves in deformed tissue: speed, scanner pixels, prediction from a simulation.

speed : the speed in a deformed state, for any law; the only module that chooses the formula
ogden : closed-form solution for the Ogden family, in the principal stretches
any_law : the formula for every other law, from the law's own tangent
pixels : from speeds at elements to the pixels of the scanner's window
from_simulation : the maps that the scanner would show at the times of a simulation

Each law uses one formula. `tests/shear_waves/test_speed.py` verifies that both formulas and the second
difference of the energy agree for every law and state.
"""
