"""Forward mechanics and pressure search: right, fast, and against scipy."""
