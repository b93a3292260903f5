"""Readers of `measure`: holds of the load cell's record, elastography screens, B-mode images."""
