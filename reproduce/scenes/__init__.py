"""What is filmed: the scenes, people and motions of the experiments."""
