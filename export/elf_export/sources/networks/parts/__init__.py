"""What networks are made of: the description that each file ends in, tables of layers, and ops that torch lacks."""
