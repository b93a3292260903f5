"""Files as such: written whole, unpacked within limits, parsed safely; folders and locks."""
