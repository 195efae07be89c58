from .model import Conversion as Conversion
