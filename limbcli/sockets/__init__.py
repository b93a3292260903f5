"""A socket on a limb: its inner face, where it sits, what it must not be, and its donning."""
