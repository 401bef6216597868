"""Where results go: files that other tools read, later links and live views."""
