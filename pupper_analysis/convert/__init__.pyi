from .conversion import Conversion as Conversion
