from .onnx import OnnxFile as OnnxFile
from .onnx import gather_fields as gather_fields
from .onnx import integers_of as integers_of
from .onnx import read_onnx as read_onnx
from .onnx import text_of as text_of
