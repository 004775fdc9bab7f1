"""From pictures of a board to cameras: what is seen, lenses, bundle adjustment, world, and what to film again."""
