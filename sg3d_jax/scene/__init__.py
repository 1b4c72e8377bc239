"""What a scene graph is: concepts, arrays, padding, proximity, validation. No learning."""
