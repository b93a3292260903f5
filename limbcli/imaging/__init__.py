"""Images: read, placed in the patient frame, segmented into skin, fat and bones, or taken from label maps."""
