"""Motors as data: electrical, mechanical and thermal numbers, each of which may be unknown."""
