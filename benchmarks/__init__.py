"""What proves the project's figures; nothing a user runs imports it."""
