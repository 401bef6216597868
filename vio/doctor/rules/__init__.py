"""What the doctor knows: one file a subject, each a list of rules."""
