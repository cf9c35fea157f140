"""Which of three arms holds three shapes under 100 loads (the paper's Fig. 5), and why."""
