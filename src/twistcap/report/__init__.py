"""Pictures for people: overlays on the video, plots of angles and errors, and the one-page report."""
