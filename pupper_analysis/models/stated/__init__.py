"""A robot as stated by a file of any format: links, joints, inertials, shapes and frames."""
