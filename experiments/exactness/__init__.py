"""Are distances from attainable sets exact? Against another algorithm on random and degenerate problems."""
