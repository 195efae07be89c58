"""What is Pupper's alone: its variants, their derivation, demos."""
