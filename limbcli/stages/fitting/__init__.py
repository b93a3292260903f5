"""What `fit` is made of: force curves, laws, options, uncertainty of geometry, mesh and contact, results."""
