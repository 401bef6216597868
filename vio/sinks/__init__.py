"""Where results go: files that other tools read, and live views."""
