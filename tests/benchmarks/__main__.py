"""`python -m tests.benchmarks`: see solver.py beside this file."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from solver import main

main()
