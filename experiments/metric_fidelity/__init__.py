"""How well metrics foretell the shape error that a pressure search finds in the end."""
