"""Two files of one robot in both engines, and what makes them disagree."""
