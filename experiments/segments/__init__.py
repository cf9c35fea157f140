"""How many pressure segments does a shape need, and does its tip need fewer?"""
