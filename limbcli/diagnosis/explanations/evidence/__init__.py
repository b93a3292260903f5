"""Evidence of explanations: marginal likelihoods, and what they come to by chance."""
