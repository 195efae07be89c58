"""Two files, one robot: whose joint, body and frame is whose, in which conventions."""
