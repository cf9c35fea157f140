"""How soon the live page's picture follows a slider, and whether it ever shows a state that is past."""
