"""Finite elements: equations, tangent, contact, Newton's method, derivatives.

The laws come first: with them go compiled loops whose source has changed.
"""

import limbcli.materials  # noqa: F401
