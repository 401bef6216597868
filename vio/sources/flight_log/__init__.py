"""Flight logs: folders of CSV files and images, read row by row."""
