"""The stiffness field of a case: its readings from the results of `fit`, `diagnose` and `mesh`."""
