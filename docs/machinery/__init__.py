"""What makes and checks the pages: none of it is needed to read them."""
