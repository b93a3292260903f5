"""Soft-tissue parameters of a residual limb from MRI, indentation and elastography.

Units inside the package: mm, N, MPa, s (mass in tonne).
"""

__version__ = "0.1.0"
