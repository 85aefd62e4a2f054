"""Where contributions, their history and the robots' poses live."""
