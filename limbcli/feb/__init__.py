"""FEBio's formats, known nowhere else: model files, logs, record files."""
