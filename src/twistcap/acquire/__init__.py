"""A body from four key views of a person: silhouettes to slices, joints and a rigged surface."""
