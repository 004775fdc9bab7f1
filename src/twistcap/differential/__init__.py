"""The differential tracker: motion of body and joints from brightness alone, in scaled orthography."""
