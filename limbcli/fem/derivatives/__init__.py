"""Exact derivatives of the response by material parameters, shape and motion; and the fields of records."""
