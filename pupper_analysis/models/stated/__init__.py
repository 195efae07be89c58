"""A robot as a file states it, whatever its format: links, joints, inertials, shapes and frames."""
