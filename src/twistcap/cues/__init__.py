"""Evidence in images, made into terms: direct contour, level-set contour, brightness."""
