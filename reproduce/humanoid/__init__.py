"""How the built-in humanoid's surface is modelled; the wheel carries the result."""
