"""Roads: height and slope over the distance, with kinks."""
