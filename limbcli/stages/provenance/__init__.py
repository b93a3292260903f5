"""What a result was made from: the options asked for, the chain of results, and whether they still hold."""
