"""Robots and stations as supervised services, after the *patrol* paper: each with a name, a versioned contract, a state
that can be asked for, messages that it takes, partners and health. docs/services.md draws them."""
