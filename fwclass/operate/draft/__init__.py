"""`fwclass init`: a first survey file, from what the files hold."""
