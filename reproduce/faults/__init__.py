"""The fault bench: captures with everyday faults, tracked, and how honestly the tracker says when it is lost."""
