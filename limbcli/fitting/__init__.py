"""What a fit consists of: force curves, laws, uncertainty of geometry, mesh and contact, results."""
