from .onnx import OnnxFile as OnnxFile
from .onnx import decode_integers as decode_integers
from .onnx import gather_fields as gather_fields
from .onnx import get_text as get_text
from .onnx import read_onnx as read_onnx
