"""A body fitted to a recording: lengths, girths, cross-sections and a smooth offset (docs/concepts/body-fit.md)."""
