"""Check of the segmented bones: limbs with changed bones, and the evidence of the readings for them."""
