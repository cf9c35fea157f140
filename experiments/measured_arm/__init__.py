"""A measured silicone module: how far off is the model, and which of its assumptions is to blame?"""
