"""Test classes for what users replace: subclass one, say how to make yours, and pytest runs the laws over it."""
