"""What a robot file says of wheels, from recorded drives whose ends were measured."""
