"""FEBio's formats, confined to this package: model files, logs, record files."""
