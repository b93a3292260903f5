"""Selection of explanations: candidates, their refits, the confidence set, and the test for a closed gap."""
