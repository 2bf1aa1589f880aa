"""Programs that prove the project's figures; nothing a user runs imports them."""
