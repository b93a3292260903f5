"""Statistical tests: score tests with family-wise adjustment, localisation, hold-out, placebos, noise."""
