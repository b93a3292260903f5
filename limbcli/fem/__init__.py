"""Finite elements: equations, tangent, contact, Newton's method, derivatives.

`limbcli.materials` is imported first: importing it discards cached compiled loops whose source has changed.
"""

import limbcli.materials  # noqa: F401
