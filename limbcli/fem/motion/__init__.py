"""Kinematics and loads: rigid bodies and their loads, load curves, prescribed values, model states."""
