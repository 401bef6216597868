"""Pictures of maps, and pages to look through them."""
