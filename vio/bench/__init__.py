"""What `tagvio bench` measures, and on which scenes."""
