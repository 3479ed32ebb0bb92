"""Identification of steering, tyres and measuring point from a recorded drive."""
