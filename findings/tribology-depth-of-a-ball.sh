#!/bin/sh
# tribology 0.4.5: a stiff ball of radius 25 mm pressed with 5 N on soft tissue (60 kPa, Poisson's ratio 0.5), by
# the package's Hertz theory: the effective modulus (`eeff`), the contact (`ahertz`) and the depth (`dhertz`).
# Guess: one theory: contact radius a = (3 F R / 4 E*)^(1/3) = 10.5 mm, depth a^2 / R = 4.4 mm.
# Seen:  the radius is right, the depth is 2.8 mm, 0.63 of it: `ahertz` takes the effective modulus as `eeff`
#        gives it, which is twice E*, and `dhertz` takes the same argument, described alike, for E* itself. A
#        modulus fitted to depths is half of the tissue's. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q tribology==0.4.5 setuptools==80.9.0 numpy==2.4.6 scipy==1.17.1 \
    matplotlib==3.11.2 opencv-python-headless==5.0.0.93 numexpr==2.14.2 Pillow==13.0.0 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import tribology

E_MPA, NU, RADIUS, FORCE, FLAT = 0.06, 0.5, 25.0, 5.0, float("inf")
modulus = tribology.eeff(E_MPA, NU, 1e9, 0.3)  # the ball is stiff
effective = tribology.reff(RADIUS, RADIUS, FLAT, FLAT)
contact = tribology.ahertz(*effective, modulus, FORCE)[0]
depth = tribology.dhertz(modulus, RADIUS, RADIUS, FLAT, FLAT, FORCE)

e_star = E_MPA / (1 - NU**2)
contact_by_hertz = (3 * FORCE * RADIUS / (4 * e_star)) ** (1 / 3)
depth_by_hertz = contact_by_hertz**2 / RADIUS
print(f"contact radius {contact:.2f} mm (Hertz {contact_by_hertz:.2f}), depth {depth:.2f} ({depth_by_hertz:.2f})")
seen = round(contact / contact_by_hertz, 3), round(depth / depth_by_hertz, 3)
sys.exit(seen != (1.0, 0.63))
PYTHON
