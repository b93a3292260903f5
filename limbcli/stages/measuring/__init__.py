"""What `measure` reads beside the load cell: elastography screens and B-mode images."""
