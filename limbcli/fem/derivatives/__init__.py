"""Exact derivatives of the response and of record fields with respect to material, shape and motion."""
