"""The tests: score tests and their family, where in the data, held-out data, placebos, the stated noise."""
