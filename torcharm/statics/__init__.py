"""Statics of an arm: the wrenches that loads ask of its nodes."""
