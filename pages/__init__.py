"""What is made of the documentation: the pages that follow from the code, the gallery, and the site."""
