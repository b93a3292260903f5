"""Parts of `fit`: force curves, laws, options, uncertainty of geometry, mesh and contact, and results."""
