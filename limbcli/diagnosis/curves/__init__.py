"""Simulated curves of force and wave speed over depth, with a cache on disk."""
