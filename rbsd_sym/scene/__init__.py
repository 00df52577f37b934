"""What a user describes: elements, user functions, and the scene they make up."""
