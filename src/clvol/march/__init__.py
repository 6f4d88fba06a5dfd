"""Pictures: rays through a scene."""
