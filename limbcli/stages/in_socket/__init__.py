"""What the stage `socket` is made of: the limb and its socket in one frame, tables, pictures, intervals."""
