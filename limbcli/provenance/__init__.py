"""Provenance of results: their options, inputs and preceding results, and whether they are out of date."""
