"""What attainable sets look like (the paper's Fig. 2 and 3), and whether its two properties hold."""
