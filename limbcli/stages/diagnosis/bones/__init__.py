"""Are the bones where `segment` has them: limbs with other bones, and what the readings say of them."""
