"""From the paper's recordings to its bellows, and what the fit does to the validation study."""
