"""What the report's pages are made from: results that still hold, simulated states, the index, failures."""
