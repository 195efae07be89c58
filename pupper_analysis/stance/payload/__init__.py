"""How much a standing robot carries."""
