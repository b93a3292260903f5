"""What `fit` is made of: force curves, laws, options, doubts of geometry, mesh and contact, results."""
