"""The report that opens offline: verdict, tables, plots, pictures."""
