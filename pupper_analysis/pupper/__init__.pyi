from .variant_files import write_variant as write_variant
from .variants import VariantSpec as VariantSpec
