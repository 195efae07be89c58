"""How is what disagrees mended? The numbers of one file are written into the other, in place."""
