"""What is measured beside `twistcap.evaluate`: distances of surfaces, norms of gait."""
