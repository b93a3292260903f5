"""Content of the report's pages: results, out-of-date results, simulated states, the index, failures."""
