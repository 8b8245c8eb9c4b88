"""What a map learns from flights. Its rules were chosen on RedKitchen 0:200, not on figures that are reported."""
