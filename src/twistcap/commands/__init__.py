"""The commands of ``twistcap``, one small file each; they only join what the rooms below offer."""
