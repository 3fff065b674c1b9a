"""Everything that draws the world: photographs, films, maps and previews. Nothing here decides an outcome."""
