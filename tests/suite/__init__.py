"""The suite of our own tree: scenarios with their baselines, and models of what each end of the wire must do."""
