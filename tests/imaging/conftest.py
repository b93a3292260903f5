"""The small limb and its DICOM writer (limb_images.py beside this file) as fixtures."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
