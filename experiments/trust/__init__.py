"""Whether what is said to be held, and to be at rest, is so: random tasks and snapped arms."""
