"""Tag maps: checked, designed, drawn, printed, read and written in other formats."""
